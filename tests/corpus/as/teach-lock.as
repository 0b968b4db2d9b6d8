; The pendant's lock is on.
; pendant: teach lock
; refused: P1002
.PROGRAM main()
.END
