; An ELSE without IF.
; mistake: P0142 5
.PROGRAM main()
  x=1
  ELSE
  x=2
.END
