; A place that was never taught.
; stops: E0103 main 1
.PROGRAM main()
  LMOVE pick.up
.END
