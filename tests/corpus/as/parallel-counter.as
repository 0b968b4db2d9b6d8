; A PC program counts while the robot program waits; three ways to end one.
; after: enough = -1
; after: ended = 0
; after: cycles = 3
; after: aborted = 0
; after: killed = 0
; after: paced = -1
; after: halves = 2
.PROGRAM main()
  ticks=0
  cycles=0
  PCEXECUTE 1: counter,-1
  PCEXECUTE 2: thrice,3
  WAIT ticks>=5
  PCEND 1:
  WAIT TASK(1001)==0
  ended=TASK(1001)
  WAIT TASK(1002)==0
  enough=(ticks>=5)
  ; one cycle takes 20 ms at least
  paced=(TIMER(1)>0.06)
  PCEXECUTE 3: forever,-1
  TWAIT 0.05
  PCABORT 3:
  aborted=TASK(1003)
  PCEXECUTE 3: forever
  TWAIT 0.05
  PCKILL 3:
  killed=TASK(1003)
  ; PCEND waits for the end of the cycle
  halves=0
  PCEXECUTE 4: slow,-1
  TWAIT 0.02
  PCEND 4:
  WAIT TASK(1004)==0
.END
.PROGRAM counter()
  PCSCAN 0.02
  ticks=ticks+1
  IF ticks==1 THEN
    TIMER 1=0
  END
.END
.PROGRAM thrice()
  cycles=cycles+1
  STOP
  cycles=-99
.END
.PROGRAM forever()
  WHILE TRUE DO
    TWAIT 0.01
  END
.END
.PROGRAM slow()
  halves=halves+1
  TWAIT 0.05
  halves=halves+1
.END
