; A length of a number.
; stops: P0116 main 1
.PROGRAM main()
  x=LEN(5)
.END
