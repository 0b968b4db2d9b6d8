; GOTO leaves a WHILE inside a FOR; the loops are as new when they are entered again.
; after: found = 7
; after: rounds = 2
.PROGRAM main()
  rounds=0
5
  rounds=rounds+1
  found=0
  FOR .i=1 TO 10
    WHILE TRUE DO
      found=.i
      IF .i==7 GOTO leave
      GOTO next
    END
next:
  END
leave:
  IF rounds<2 GOTO 5
.END
