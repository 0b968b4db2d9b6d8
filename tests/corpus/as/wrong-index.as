; An index below zero.
; stops: P0119 main 2
.PROGRAM main()
  .k=-1
  x[.k]=3
.END
