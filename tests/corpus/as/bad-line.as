; A file cut in the middle: text outside of every program.
; mistake: P0109 3
hello there
.PROGRAM main()
.END
