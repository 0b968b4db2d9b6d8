; A datagram to the controller's own port, cut into elements; then none; the open TCP ports.
; after: nothing = -34024
; after: sent = 0
; after: got = 0
; after: n = 3
; after: $cut[2] = "def"
; after: $cut[3] = "g"
; after: peer[4] = 1
; after: opened = 1
; after: ports[0] = 49153
; after: socks[0] = 0
; after: errs[0] = 0
; after: $ips[0] = "0.0.0.0"
.PROGRAM main()
  ip[1]=127
  ip[2]=0
  ip[3]=0
  ip[4]=1
  UDP_RECVFROM nothing,49152,$cut[1],n,1,peer[1],3
  $text[1]="abcd"
  $text[2]="efg"
  UDP_SENDTO sent,ip[1],49152,$text[1],2,1
  UDP_RECVFROM got,49152,$cut[1],n,1,peer[1],3
  TCP_LISTEN ret,49153
  TCP_STATUS opened,ports[0],socks[0],errs[0],subs[0],$ips[0]
  TCP_END_LISTEN ret,49153
.END
