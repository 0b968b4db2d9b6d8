; DRAW in base axes, TDRAW in the tool's: the tool looks down, so its z is the other way.
; after: right = 20 +- 0.2
; after: higher = 10 +- 0.2
; after: lower = 0 +- 0.3
; after: turned = 30 +- 0.1
.PROGRAM main()
  SPEED 100 MM/S ALWAYS
  HERE start
  DRAW 20,0,10
  BREAK
  right=DX(HERE)-DX(start)
  higher=DZ(HERE)-DZ(start)
  TDRAW 0,0,10
  BREAK
  lower=DZ(HERE)-DZ(start)
  HERE before
  DRAW 0,0,0,0,0,30
  BREAK
  POINT .turn=-before+HERE
  turned=ABS(DEXT(.turn,4)+DEXT(.turn,6))
.END
