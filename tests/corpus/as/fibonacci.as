; DO UNTIL tests last, WHILE tests first.
; after: f = 144
; after: turns = 11
; after: never = 0
; after: once = 1
.PROGRAM main()
  .a=1
  f=1
  turns=1
  DO
    .next=.a+f
    .a=f
    f=.next
    turns=turns+1
  UNTIL f>=144
  never=0
  WHILE never>0 DO
    never=99
  END
  once=0
  DO
    once=once+1
  UNTIL TRUE
.END
