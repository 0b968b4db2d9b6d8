; Three metres away.
; stops: E6007 main 1
.PROGRAM main()
  LMOVE TRANS(0,3000,300,0,180,0)
.END
