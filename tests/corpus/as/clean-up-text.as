; A label printer's line taken apart: $LEFT, $MID, $RIGHT, INSTR, LEN, ASC, VAL.
; after: $code = "AB"
; after: serial = 123
; after: $tail = "Z"
; after: colon = 3
; after: second = 7
; after: length = 8
; after: ascii = 65
; after: none = -1
; after: $all = "AB:123:Z"
; after: hex = 255
; after: sci = 0.000012 +- 0.0000000001
; after: binary = 5
.PROGRAM main()
  $line="AB:123:Z"
  colon=INSTR($line,":")
  second=INSTR(colon+1,$line,":")
  $code=$LEFT($line,colon-1)
  serial=VAL($MID($line,colon+1,second-colon-1))
  $tail=$RIGHT($line,LEN($line)-second)
  length=LEN($line)
  ascii=ASC($line)
  none=ASC($line,99)
  $all=$LEFT($line,99)
  hex=VAL("^HFF")
  sci=VAL("1.2E-5")
  binary=VAL("101",1)
.END
