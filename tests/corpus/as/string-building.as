; Padding by hand, control characters, blanks, comparison by character code.
; after: $padded = "00042"
; after: $boxed = "[     ]"
; after: crlf = 2
; after: code = 13
; after: less = -1
; after: equal = 0
; after: shorter = -1
; after: seek = 4
; after: empty = 2
.PROGRAM main()
  $padded=$RIGHT($ENCODE(/I6,100000+42),5)
  $boxed="["+$SPACE(5)+"]"
  $end=$CHR(13)+$CHR(10)
  crlf=LEN($end)
  code=ASC($end,1)
  less="abc"<"abd"
  equal="abc"=="ABC"
  shorter="ab"<"abc"
  seek=INSTR("abcdefgh","DE")
  empty=INSTR(2,"abc","")
.END
