; Four bottles in a row: SHIFT along the base axes, orientation kept, count by FOR.
; after: bottles = 4
; after: slot.no = 5
; after: x.last = 90 +- 0.01
; after: moved = 90 +- 0.2
.PROGRAM main()
  SPEED 200 MM/S ALWAYS
  ACCURACY 1 ALWAYS
  HERE crate
  bottles=0
  FOR slot.no=1 TO 4
    POINT slot=SHIFT(crate BY 30*(slot.no-1),0,0)
    LMOVE slot
    bottles=bottles+1
  END
  BREAK
  TWAIT 0.2
  x.last=DX(slot)-DX(crate)
  moved=DISTANCE(HERE,crate)
.END
