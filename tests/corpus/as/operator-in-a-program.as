; MC of a PC program in place of an operator: motors, a primed program, what cannot be continued.
; runs: nothing
; stops: P1011 boss 11
; stops: P0104 boss 12
; after: dark = 0
; after: waits = 2
; after: done = 1
.PROGRAM nothing()
  PCEXECUTE 1: boss
.END
.PROGRAM boss()
  WAIT TASK(1)==0
  MC ZPOWER OFF
  dark=SWITCH(POWER)
  MC ZPOWER ON
  MC SPEED 1: 50
  MC PRIME work
  waits=TASK(1)
  MC CONTINUE
  WAIT TASK(1)==0
  ONE note
  MC CONTINUE
  MC SPEED 2: 50
.END
.PROGRAM work()
  done=1
.END
.PROGRAM note()
  RETURNE
.END
