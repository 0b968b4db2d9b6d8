; A text where a number belongs.
; stops: P0118 main 1
.PROGRAM main()
  TWAIT "soon"
.END
