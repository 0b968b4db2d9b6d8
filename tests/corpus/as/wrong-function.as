; A function that this controller does not have.
; stops: P0115 main 1
.PROGRAM main()
  x=PRIORITY
.END
