; FOR: zero turns, downwards, fractions, end and step computed once, the value behind the end.
; after: zero = 0
; after: after.zero = 5
; after: down = 4
; after: after.down = 0
; after: quarters = 5
; after: fixed = 3
.PROGRAM main()
  zero=0
  FOR after.zero=5 TO 4
    zero=zero+1
  END
  down=0
  FOR after.down=8 TO 2 STEP -2
    down=down+1
  END
  quarters=0
  FOR .q=0 TO 1 STEP 0.25
    quarters=quarters+1
  END
  fixed=0
  .last=3
  FOR .i=1 TO .last
    .last=99
    fixed=fixed+1
  END
.END
