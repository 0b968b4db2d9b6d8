; The operator forgot the motor power.
; pendant: motors off
; refused: P1000
.PROGRAM main()
  HOME
.END
