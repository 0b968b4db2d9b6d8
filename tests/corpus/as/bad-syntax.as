; Two mistakes, found in one go: a comma in an assignment, a text that is not closed.
; mistake: P0108 5
; mistake: P0108 7
.PROGRAM main()
  x=1,2
  y=3
  $s="no end
.END
