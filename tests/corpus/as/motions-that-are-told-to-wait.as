; DELAY between motions, MVWAIT before the end, BRAKE in the middle.
; after: near = 30 +- 12
; after: way = 60 +- 1
; after: paused = -1
; after: short = -1
; after: whole = 60 +- 1
.PROGRAM main()
  SPEED 100 MM/S ALWAYS
  HERE start
  LMOVE SHIFT(start BY 60,0,0)
  MVWAIT 30
  near=DISTANCE(HERE,SHIFT(start BY 60,0,0))
  BREAK
  way=DISTANCE(HERE,start)
  TIMER 1=0
  DELAY 0.3
  LMOVE start
  BREAK
  paused=(TIMER(1)>0.8)
  PREFETCH.SIGINS ON
  LMOVE SHIFT(start BY 60,0,0)
  TWAIT 0.2
  BRAKE
  short=(DISTANCE(HERE,start)<50)
  PREFETCH.SIGINS OFF
  LMOVE SHIFT(start BY 60,0,0)
  TWAIT 0.2
  BRAKE
  whole=DISTANCE(HERE,start)
.END
