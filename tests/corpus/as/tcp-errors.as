; What comes back when the network does not: codes to test, no stop of the program.
; after: nobody = -34023
; after: late = -34024
; after: not.open = -34056
; after: twice = -34055
; after: no.socket = -34057
; after: too.long = -34022
; after: gone = -34025
; after: $why = "(E4024)Communication time out error"
; after: silent = -34024
.PROGRAM main()
  port=49152
  ip[0]=127
  ip[1]=0
  ip[2]=0
  ip[3]=1
  TCP_CONNECT nobody,port,ip[0],1
  TCP_ACCEPT not.open,port,1
  TCP_LISTEN .r,port
  TCP_LISTEN twice,port
  TCP_ACCEPT late,port,1
  $why=$ERROR(late)
  TCP_CONNECT .a,port,ip[0],1
  TCP_ACCEPT .b,port,1
  TCP_RECV silent,.a,$x[1],.n,1
  FOR .i=1 TO 20
    $big[.i]=$SPACE(250)
  END
  TCP_SEND too.long,.a,$big[1],20,1
  TCP_CLOSE .r,.b
  TCP_SEND gone,.a,$big[1],1,1
  TCP_CLOSE .r,.a
  TCP_CLOSE no.socket,.a
  TCP_END_LISTEN .r,port
.END
