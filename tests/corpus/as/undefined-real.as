; A typing mistake: a variable that nobody has defined stops the program where it is used.
; stops: E0102 main 2
; after: x = 1
.PROGRAM main()
  x=1
  x=x+cuonter
  x=99
.END
