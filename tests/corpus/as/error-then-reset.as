; The same with MC ERESET: the program starts again, and gets further.
; stops: E0108 main 4
; after: tries = 2
; after: x = 1
.PROGRAM main()
  tries=MAXVAL(1,1-2*EXISTREAL("tries"))
  IF tries>1 GOTO good
  PCEXECUTE 1: boss
  x=1/0
good:
  tries=2
  x=1/1
.END
.PROGRAM boss()
  WAIT TASK(1)<>1
  MC ERESET
  MC EXECUTE main
.END
