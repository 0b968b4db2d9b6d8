; The last point of an arc without the one before it.
; stops: E1098 main 1
.PROGRAM main()
  C2MOVE HERE
.END
