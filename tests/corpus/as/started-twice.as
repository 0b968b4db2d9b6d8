; EXECUTE while the robot program runs: refused, and the PC program that asked stops.
; stops: P1009 boss 1
; after: over = 1
.PROGRAM main()
  PCEXECUTE 1: boss
  TWAIT 0.1
  over=1
.END
.PROGRAM boss()
  MC EXECUTE main
.END
