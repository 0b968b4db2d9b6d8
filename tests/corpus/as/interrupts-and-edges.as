; ON is for edges: a state counts with /LVL only; the higher priority is served first.
; after: never.served = 0
; after: level.served = 1
; after: fallen.served = 1
; after: order = 21
; after: newest = 2
.PROGRAM main()
  never.served=0
  level.served=0
  fallen.served=0
  order=0
  newest=0
  SIGNAL 2003,2004,2005
  ON 2003 CALL never
  ON/LVL 2004 CALL level
  TWAIT 0.05
  ON -2005 CALL fallen
  SIGNAL -2005
  TWAIT 0.05
  ON 2001 CALL one
  ON 2002 CALL two,9
  PCEXECUTE 1: both
  WAIT order>9
  TWAIT 0.05
  ON 2006 CALL never
  ON 2006 CALL newer
  SIGNAL 2006
  TWAIT 0.05
.END
.PROGRAM never()
  never.served=never.served+1
.END
.PROGRAM level()
  level.served=level.served+1
.END
.PROGRAM fallen()
  fallen.served=fallen.served+1
.END
.PROGRAM one()
  order=order*10+1
.END
.PROGRAM two()
  order=order*10+2
.END
.PROGRAM newer()
  newest=2
.END
.PROGRAM both()
  TWAIT 0.05
  SIGNAL 2001,2002
.END
