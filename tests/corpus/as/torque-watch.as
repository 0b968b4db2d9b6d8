; Motor current and torque of a standing arm: joint 2 and 3 carry, joint 6 does not.
; after: light = -1
; after: same = -1
.PROGRAM main()
  TWAIT 0.2
  light=(ABS(TRQNM(6))<1)
  same=(ABS(IQARM(2)-TRQNM(2))<20)
.END
