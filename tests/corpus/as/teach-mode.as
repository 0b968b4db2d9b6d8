; The switch stands on TEACH.
; pendant: teach
; refused: P1001
.PROGRAM main()
.END
