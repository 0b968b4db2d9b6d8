; A server as PC program, a client as robot program: text there, cut into elements, and back.
; after: connected = -1
; after: sent = 0
; after: parts = 3
; after: $part[1] = "HELL"
; after: $part[2] = "O, r"
; after: $part[3] = "obot"
; after: $answer = "HELLO, robot"
; after: answers = 1
; after: from.here = -1
; after: left = 0
; after: closed = 0
; after: over = 0
.PROGRAM main()
  port=49152
  PCEXECUTE 1: server
  TWAIT 0.1
  ip[1]=127
  ip[2]=0
  ip[3]=0
  ip[4]=1
  TCP_CONNECT .s,port,ip[1],2
  connected=(.s>0)
  $out[1]="HELLO"
  $out[2]=", robot"
  TCP_SEND sent,.s,$out[1],2,1
  TCP_RECV .r,.s,$in[1],answers,2
  $answer=$in[1]
  TCP_CLOSE closed,.s
  WAIT TASK(1001)==0
.END
.PROGRAM server()
  TCP_LISTEN .r,port
  TCP_ACCEPT .s,port,5,peer[1]
  from.here=(peer[1]==127) AND (peer[4]==1)
  TCP_RECV .r,.s,$part[1],parts,2,4
  TCP_SEND .r,.s,$part[1],parts,1
  ; the other end has closed: no error, and nothing
  TCP_RECV .r,.s,$rest[1],.n,5
  left=.r+.n
  TCP_CLOSE .r,.s
  TCP_END_LISTEN over,port
.END
