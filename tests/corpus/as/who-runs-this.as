; WHICHTASK: the task that is in a program, also in one of its subroutines; -1 if none is.
; after: mine = 1
; after: other = 1002
; after: inner = 1002
; after: free = -1
; after: over = -1
.PROGRAM main()
  $helper="helper"
  mine=WHICHTASK("main")
  free=WHICHTASK($helper)
  PCEXECUTE 2: sender
  TWAIT 0.05
  other=WHICHTASK("SENDER")
  inner=WHICHTASK($helper)
  WAIT TASK(1002)==0
  over=WHICHTASK($helper)
.END
.PROGRAM sender()
  CALL helper
.END
.PROGRAM helper()
  TWAIT 0.1
.END
