; The 121st per cent; SPEED ends at 100.
; stops: E0106 main 1
.PROGRAM main()
  SPEED 121
.END
