; Only fifteen characters of a name count, and capitals do not.
; after: abcdefghijklmno = 2
; after: mixed = 3
.PROGRAM main()
  abcdefghijklmnoPQR=1
  ABCDEFGHIJKLMNOxyz=2
  MiXeD=3
.END
