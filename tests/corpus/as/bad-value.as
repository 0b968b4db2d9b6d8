; A VALUE outside of CASE.
; mistake: P0145 4
.PROGRAM main()
  VALUE 1:
.END
