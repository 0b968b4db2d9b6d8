; A program that is not loaded.
; stops: E0105 main 1
.PROGRAM main()
  CALL greaser
.END
