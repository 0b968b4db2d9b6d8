; Commands as words: SCASE compares strings, and capitals matter.
; after: first = 1
; after: pick = 1
; after: other = 1
.PROGRAM main()
  pick=0
  other=0
  $word="pick"
  SCASE $word OF
  SVALUE "PICK":
    pick=2
  SVALUE "place","pick":
    pick=1
  ANY :
    other=3
  END
  SCASE $word+"s" OF
  SVALUE "pick":
    other=2
  ANY :
    other=1
  END
  SCASE "a" OF
  SVALUE "a":
    first=1
  SVALUE "a","b":
    first=2
  END
.END
