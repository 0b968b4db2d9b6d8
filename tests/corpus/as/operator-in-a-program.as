; MC of a PC program in place of an operator: motors, a primed program, what cannot be continued.
; runs: nothing
; stops: P1011 boss 12
; stops: P0104 boss 13
; after: dark = 0
; after: waits = 2
; after: done = 2
.PROGRAM nothing()
  PCEXECUTE 1: boss
.END
.PROGRAM boss()
  WAIT TASK(1)==0
  done=0
  MC ZPOWER OFF
  dark=SWITCH(POWER)
  MC ZPOWER ON
  MC SPEED 1: 50
  MC PRIME work,2
  waits=TASK(1)
  MC CONTINUE
  WAIT TASK(1)==0
  ONE note
  MC CONTINUE
  MC SPEED 2: 50
.END
.PROGRAM work()
  done=done+1
.END
.PROGRAM note()
  RETURNE
.END
