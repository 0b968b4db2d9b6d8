; MC is for PC programs.
; stops: P0111 main 1
.PROGRAM main()
  MC SPEED 10
.END
