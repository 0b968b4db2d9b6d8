; Clamps: which signals drive them is a setting of the controller, so each change is reported.
; prints: clamp 1: open
; prints: clamp 2: closed
; prints: clamp 3: off
; prints: clamp 1: closed
; prints: clamp 2: open
; prints: clamp 4: open
; prints: clamp 5: closed
; prints: clamp 6: off
; prints: clamp 7: open
; prints: clamp 8: closed
; prints: clamp 7: off
.PROGRAM main()
  OPENS 1
  CLOSES 2
  RELAXS 3
  CLOSEI 1
  OPENI 2
  OPEN 4
  CLOSE 5
  RELAX 6
  LDEPART 10
  BREAK
  CLAMP 7,-8
  RELAXI 7
  TWAIT 0.1
.END
