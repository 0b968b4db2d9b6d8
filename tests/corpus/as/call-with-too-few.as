; Two parameters, one argument.
; stops: P0137 main 1
.PROGRAM main()
  CALL add(1)
.END
.PROGRAM add(.a,.b)
.END
