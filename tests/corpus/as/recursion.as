; A subroutine that calls itself: it is in use.
; stops: P1014 again 1
.PROGRAM main()
  CALL again
.END
.PROGRAM again()
  CALL again
.END
