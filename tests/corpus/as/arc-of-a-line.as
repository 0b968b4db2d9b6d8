; Three points on a line are no arc.
; stops: E1099 main 2
.PROGRAM main()
  C1MOVE SHIFT(HERE BY 9,0,0)
  C2MOVE SHIFT(HERE BY 20,0,0)
.END
