; A search for a signal that is there already.
; stops: E1071 main 2
.PROGRAM main()
  SIGNAL 2001
  XMOVE/ERR SHIFT(HERE BY 9,0,0) TILL 2001
.END
