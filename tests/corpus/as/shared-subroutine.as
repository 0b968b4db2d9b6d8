; The same subroutine in two tasks at once: P1014, only under load.
; stops: P1014 main 3
.PROGRAM main()
  PCEXECUTE 1: slow
  TWAIT 0.05
  CALL slow
.END
.PROGRAM slow()
  TWAIT 0.5
.END
