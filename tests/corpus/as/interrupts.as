; ON calls a program at the edge of a signal, ONI stops the motion for it; IGNORE ends it.
; after: counted = 1
; after: left = -1
; after: quiet = 1
.PROGRAM main()
  counted=0
  PCEXECUTE 1: signals
  ON 2001 CALL count
  WAIT counted>0
  ON 2003 CALL count
  IGNORE 2003
  SIGNAL 2003
  TWAIT 0.1
  quiet=counted
  HERE p
  SPEED 50 MM/S ALWAYS
  ONI 2002 GOTO out
  LMOVE SHIFT(p BY 80,0,0)
  BREAK
  left=0
out:
  left=(DISTANCE(DEST,p)<80)
.END
.PROGRAM count()
  counted=counted+1
.END
.PROGRAM signals()
  TWAIT 0.1
  SIGNAL 2001
  TWAIT 0.4
  SIGNAL 2002
.END
