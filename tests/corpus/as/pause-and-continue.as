; PAUSE holds the robot program until a person, here a PC program, presses CONTINUE.
; after: before = 1
; after: state = 2
; after: behind = 1
; after: halted = 1
.PROGRAM main()
  before=1
  behind=0
  LOCK 10
  PCEXECUTE 5: person
  PAUSE
  behind=1
  WAIT TASK(1005)==0
  halted=1
  HALT
  halted=2
.END
.PROGRAM person()
  WAIT TASK(1)==2
  state=TASK(1)
  TWAIT 0.05
  MC CONTINUE
.END
