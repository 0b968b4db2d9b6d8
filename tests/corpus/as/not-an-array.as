; A single variable with an index.
; stops: P0132 main 2
.PROGRAM main()
  x=1
  x[1]=2
.END
