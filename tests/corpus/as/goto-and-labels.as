; Retry three times: labels as numbers and as names, GOTO with and without IF.
; after: tries = 3
; after: path = 12
.PROGRAM main()
  tries=0
  path=0
again:
  tries=tries+1
  IF tries<3 GOTO again
  GOTO 20
  path=-1
20 path=path+10
  GOTO out IF tries==3
  path=-2
out: path=path+2
.END
