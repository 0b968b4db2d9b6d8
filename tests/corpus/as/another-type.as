; A name holds a real or a place, not both.
; stops: P0150 main 2
.PROGRAM main()
  x=1
  POINT x=NULL
.END
