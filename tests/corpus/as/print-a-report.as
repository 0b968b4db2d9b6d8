; What an operator reads: PRINT and TYPE, devices, an open line with /S.
; prints: parts: 12
; prints: mean   3.25 mm
; prints: half a line, the rest
; prints: done
.PROGRAM main()
  n=12
  PRINT "parts:",n
  TYPE 1: "mean",/F7.2,3.25," mm"
  PRINT "half a line",/S
  PRINT ", the rest"
  TYPE "done"
.END
