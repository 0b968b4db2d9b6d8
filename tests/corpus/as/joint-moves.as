; Joint angles as a target: #PPOINT, the literal, DECOMPOSE, INRANGE.
; after: j[4] = 0 +- 0.05
; after: j[9] = 12 +- 0.05
; after: ok = 0
; after: joint2 = 2
; after: reach = 32768
; after: x[1] = 1
; after: x[6] = 6
.PROGRAM main()
  SPEED 80 ALWAYS
  POINT #goal=#PPOINT(0,5,-85,0,-90,12)
  ok=INRANGE(#goal)
  JMOVE #goal
  BREAK
  HERE #now
  DECOMPOSE j[4]=#now
  JMOVE #[0,0,-90,0,-90,0]
  joint2=INRANGE(#[0,150,-90,0,-90,0])
  reach=INRANGE(TRANS(3000))
  DECOMPOSE x[1]=TRANS(1,2,3,4,5,6)
.END
