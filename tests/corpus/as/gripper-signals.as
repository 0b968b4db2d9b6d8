; Close, wait for the finger, pulse a blower, read eight inputs as a number.
; after: closed = -1
; after: opened = 0
; after: not.both = 0
; after: blown = -1
; after: over = 0
; after: word = 165
; after: wide = 165
; after: dark = 0
; after: inner = -1
; after: waited = 0.1 +- 0.03
.PROGRAM main()
  RESET
  SIGNAL 1,-2
  closed=SIG(1,-2)
  opened=SIG(2)
  not.both=SIG(1,2)
  PULSE 5,0.1
  blown=SIG(5)
  TIMER 1=0
  SWAIT 1,-5
  waited=TIMER(1)
  over=SIG(5)
  BITS 11,8=165
  word=BITS(11,8)
  wide=BITS32(11,16)
  SIGNAL 2001
  SWAIT 2001,1
  RESET
  dark=SIG(1)
  inner=SIG(2001)
.END
