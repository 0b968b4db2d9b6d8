; Two numbers and nothing between them.
; mistake: P0121 4
.PROGRAM main()
  x=1 2
.END
