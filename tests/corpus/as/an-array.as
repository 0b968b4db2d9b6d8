; An array without its index.
; stops: P0133 main 2
.PROGRAM main()
  x[1]=2
  x=1
.END
