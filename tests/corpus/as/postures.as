; Posture instructions break the path and are taken; switches too.
; after: cp = 0
; after: on.again = -1
; after: power = -1
; after: repeat = -1
.PROGRAM main()
  LEFTY
  RIGHTY
  ABOVE
  BELOW
  UWRIST
  DWRIST
  CP OFF
  cp=SWITCH(CP)
  CP ON
  on.again=SWITCH(CP)
  power=SWITCH(POWER)
  repeat=SWITCH(REPEAT)
.END
