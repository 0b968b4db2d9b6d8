; The mode /ERR refuses to monitor a signal that is there already.
; stops: E1070 main 2
.PROGRAM main()
  SIGNAL 2001
  ON/ERR 2001 CALL helper
.END
.PROGRAM helper()
.END
