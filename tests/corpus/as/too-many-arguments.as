; Seven components of a pose.
; stops: P0101 main 1
.PROGRAM main()
  POINT p=TRANS(1,2,3,4,5,6,7)
.END
