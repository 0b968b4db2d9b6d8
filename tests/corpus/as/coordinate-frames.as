; A work table as BASE, a gripper as TOOL: the same place has other numbers.
; after: up = 50 +- 0.01
; after: tool.z = 120 +- 0.001
; after: base.x = 100 +- 0.001
; after: shifted = -100 +- 0.01
; after: back = 0 +- 0.01
.PROGRAM main()
  HERE bare
  TOOL TRANS(0,0,120)
  HERE gripped
  ; the flange looks down: the tool's tip is lower
  up=DZ(bare)-DZ(gripped)-70
  tool.z=DZ(TOOL)
  BASE TRANS(100)
  base.x=DX(BASE)
  HERE seen
  shifted=DX(seen)-DX(gripped)
  BASE NULL
  TOOL
  HERE again
  back=DISTANCE(again,bare)
  WEIGHT 2.5,0,0,60
.END
