; A parenthesis that is not closed.
; mistake: P0120 4
.PROGRAM main()
  x=(1+2
.END
