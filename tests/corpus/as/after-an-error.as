; Nothing starts before ERESET.
; stops: E0108 main 2
; stops: P1013 boss 2
.PROGRAM main()
  PCEXECUTE 1: boss
  x=1/0
.END
.PROGRAM boss()
  WAIT TASK(1)<>1
  MC EXECUTE main
.END
