; Every format of $ENCODE, as a report prints them.
; after: $f = "12.67"
; after: $wide = "*****"
; after: $i = "   42"
; after: $h = "00FF"
; after: $plain = " 1.5 -2"
; after: $e = "   1.50E+03"
; after: $g = "1.5000"
; after: $mixed = "x=   7y"
; after: lines = 3
; after: $gap = "a   b"
; after: $quoted = "say 'A' = A"
.PROGRAM main()
  $f=$ENCODE(/F5.2,12.66666)
  $wide=$ENCODE(/F5.2,1000)
  $i=$ENCODE(/I5,42)
  $h=$RIGHT("0000"+$ENCODE(/H2,255),4)
  $plain=$ENCODE(/D,1.5,-2)
  $e=$ENCODE(/E11.2,1500)
  $g=$ENCODE(/G6.5,1.5)
  $mixed=$ENCODE("x=",/I4,7,"y")
  lines=LEN($ENCODE("a",/C2))
  $gap=$ENCODE("a",/X3,"b")
  $quoted="say 'A' = "+$CHR(65)
.END
