; A local of one call is not that of another; a global is everybody's.
; after: shared = 3
; after: kept = 1
; after: fresh = 0
.PROGRAM main()
  shared=1
  .mine=1
  CALL other
  CALL other
  kept=.mine
.END
.PROGRAM other()
  shared=shared+1
  fresh=EXISTLOCALREAL(".mine")
  .mine=99
.END
