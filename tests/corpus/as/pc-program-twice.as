; PC program 1 runs already.
; stops: P1019 main 2
.PROGRAM main()
  PCEXECUTE 1: idle
  PCEXECUTE 1: other
.END
.PROGRAM idle()
  TWAIT 1
.END
.PROGRAM other()
.END
