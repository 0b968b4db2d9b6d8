; An arc whose last point is missing.
; stops: E1097 main 2
.PROGRAM main()
  C1MOVE HERE
  LMOVE HERE
.END
