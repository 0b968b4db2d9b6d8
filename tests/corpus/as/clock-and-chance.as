; Time of day, uptime, timers and a random number: ranges, not values.
; after: waited = 0.5 +- 0.02
; after: preset = 100.25 +- 0.02
; after: later = -1
; after: dice = -1
; after: day = 8
; after: hour = 8
; after: half.turn = 3.141593 +- 0.000001
.PROGRAM main()
  .start=TIMER(0)
  TIMER 1=0
  TIMER 2=100
  TWAIT 0.25
  preset=TIMER(2)
  TWAIT 0.25
  waited=TIMER(1)
  later=(TIMER(0)>.start)
  .r=RANDOM
  dice=(.r>=0) AND (.r<1)
  day=LEN($DATE)
  hour=LEN($TIME)
  half.turn=PI
.END
