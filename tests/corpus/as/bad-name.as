; A program's name that begins with a digit.
; mistake: P0117 3
.PROGRAM 9lives()
.END
