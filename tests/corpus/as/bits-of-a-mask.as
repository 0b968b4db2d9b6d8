; Which of eight clamps are closed: bit operators on 32 bits, and their priorities.
; after: both = 40
; after: all = 43
; after: changed = 3
; after: inverse = -44
; after: logic = -1
; after: either = 0
; after: no = 0
; after: still = -1
; after: third = -1
; after: tight = 1
; after: hex = 255
; after: letter = 65
.PROGRAM main()
  .before=^B101010
  .after=^B101001
  both=.before BAND .after
  all=.before BOR .after
  changed=.before BXOR .after
  inverse=COM all
  logic=.before OR 0
  either=.before XOR .after
  no=NOT .before
  still=.before AND .after
  third=(all BAND ^B1000)<>0
  ; a relation binds tighter than BAND: 1 BAND (3==3)
  tight=1 BAND 3==3
  hex=^HFF
  letter='A
.END
