; An END too many.
; mistake: P0141 5
.PROGRAM main()
  x=1
  END
.END
