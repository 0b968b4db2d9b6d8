; An UNTIL without DO.
; mistake: P0143 5
.PROGRAM main()
  x=1
  UNTIL x==1
.END
