; SYSDATA, user timers and variables by name, as public programs use them.
; prints: RS007L
; after: axes = 6
; after: step = 3
; after: whole = -1
; after: spent = 0.2 +- 0.01
; after: five = 6
; after: up = 40 +- 0.001
; after: pose = -1
; after: number = 0
; after: program = -1
; after: length = 12
.PROGRAM main()
  TYPE $SYSDATA(ZROB.NAME)
  axes=SYSDATA(ZROB.NOWAXIS)
  step=SYSDATA(STEP)
  UTIMER @timer=0
  TWAIT 0.2
  spent=UTIMER(@timer)
  whole=(SYSDATA(ERROR.CODE)==0)
  POINT hole[3]=TRANS(1,2,40)
  $name="hole[3]"
  up=DZ(STRTOPOS($name))
  five=5
  five=STRTOVAL("five")+1
  pose=EXISTDATA($name,T)
  number=EXISTDATA("hole",R)
  program=EXISTDATA("main",G)
  length=LEN($TIME_MS)
.END
