; An IF that nothing closes.
; mistake: P0140 4
.PROGRAM main()
  IF x==1 THEN
    y=1
.END
