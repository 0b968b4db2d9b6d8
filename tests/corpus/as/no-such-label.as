; A label that is not there: found when the step is reached.
; stops: E0101 main 2
.PROGRAM main()
  x=1
  GOTO nowhere
.END
