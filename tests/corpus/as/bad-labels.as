; A label that stands there twice.
; mistake: P0146 5
.PROGRAM main()
10 x=1
10 x=2
.END
