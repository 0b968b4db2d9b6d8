; Motion belongs into the robot program.
; stops: E1095 helper 1
.PROGRAM main()
  PCEXECUTE 1: helper
  TWAIT 0.1
.END
.PROGRAM helper()
  LMOVE NULL
.END
