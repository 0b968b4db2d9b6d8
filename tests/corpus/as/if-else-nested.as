; Grading by size: nested IF with ELSE, and TRUE as -1.
; after: small = 2
; after: middle = 3
; after: large = 4
; after: truth = -1
; after: flag = 0
; after: spelled = 4
.PROGRAM main()
  small=0
  middle=0
  large=0
  FOR .size=1 TO 9
    IF .size<3 THEN
      small=small+1
    ELSE
      IF .size<=5 THEN
        middle=middle+1
      ELSE
        large=large+1
      END
    END
  END
  truth=(3>2)
  flag=(truth==1)
  ; each relation has two spellings, one of them from other languages
  spelled=-(1=<2)-(2=>1)-(1!=2)-(1<>2)
.END
