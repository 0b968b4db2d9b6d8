; There are eight clamps.
; stops: E1075 main 1
.PROGRAM main()
  OPENI 9
.END
