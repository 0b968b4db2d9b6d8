; THEN, DO, OF and colons left out, % for MOD: as in public programs; the check warns about each.
; after: odd = 3
; after: kind = 2
.PROGRAM main()
  n=0
  odd=0
  WHILE n<6
    n=n+1
    IF n%2==1
      odd=odd+1
    END
  END
  CASE odd
  VALUE 1,2
    kind=1
  ANY
    kind=2
  END
.END
