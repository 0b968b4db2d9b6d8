; A real that is a word.
; mistake: P0100 5
.REALS
a = 1
b = one
.END
