; A PC program as the operator: MC starts, holds, continues and ends the robot program.
; runs: nothing
; stops: P1009 boss 14
; after: started = 1
; after: held = 2
; after: running = 1
; after: ended = 0
; after: speed = 50 +- 0.001
; after: refused = -11009
.PROGRAM nothing()
  PCEXECUTE 1: boss
.END
.PROGRAM boss()
  WAIT TASK(1)==0
  MC SPEED 50
  speed=MSPEED
  MC EXECUTE work,-1
  TWAIT 0.1
  started=TASK(1)
  MC HOLD
  TWAIT 0.1
  held=TASK(1)
  MC CONTINUE
  TWAIT 0.1
  running=TASK(1)
  ONE note
  MC EXECUTE work
  MC ABORT
  MC ERESET
  WAIT TASK(1)==0
  ended=TASK(1)
.END
.PROGRAM work()
  TWAIT 0.05
.END
.PROGRAM note()
  refused=ERROR
  RETURNE
.END
