; A circle of 60 mm in two arcs, then a search that a signal ends, and the tool straightened.
; after: back = 0 +- 0.01
; after: half = 60 +- 0.05
; after: stopped = -1
; after: tilt = 180 +- 0.01
; after: percent = 50
.PROGRAM main()
  MON_SPEED 50
  percent=MSPEED
  SPEED 200 MM/S ALWAYS
  HERE p
  C1MOVE SHIFT(p BY 30,30,0)
  C2MOVE SHIFT(p BY 60,0,0)
  BREAK
  half=DISTANCE(DEST,p)
  C1MOVE SHIFT(p BY 30,-30,0)
  C2MOVE p
  BREAK
  back=DISTANCE(DEST,p)
  PCEXECUTE 1: touch
  XMOVE SHIFT(p BY 0,0,90) TILL 2001
  stopped=(DISTANCE(DEST,p)<80)
  LMOVE p+RX(15)
  ALIGN
  BREAK
  POINT q=DEST
  DECOMPOSE tilts[1]=q
  tilt=tilts[5]
.END
.PROGRAM touch()
  TWAIT 0.3
  SIGNAL 2001
.END
