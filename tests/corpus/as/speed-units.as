; Every unit of SPEED: per cent, mm/s, mm/min, seconds; ACCURACY without ALWAYS holds once.
; after: took = 1 +- 0.15
; after: same = 1 +- 0.15
; after: timed = 2 +- 0.15
.PROGRAM main()
  ACCURACY 5 ALWAYS
  ACCURACY 1 FINE
  HERE p
  TIMER 1=0
  SPEED 50 MM/S
  LMOVE SHIFT(p BY 50,0,0)
  BREAK
  took=TIMER(1)
  TIMER 1=0
  SPEED 3000 MM/MIN
  LMOVE p
  BREAK
  same=TIMER(1)
  TIMER 1=0
  SPEED 2 S
  LMOVE SHIFT(p BY 50,0,0)
  BREAK
  timed=TIMER(1)
  SPEED 30 ALWAYS
  JMOVE p
.END
