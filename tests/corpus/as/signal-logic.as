; Signals by logic, later, in groups, and only while the program runs.
; after: both = -1
; after: later = -1
; after: wide = 65541
.PROGRAM main()
  SIGNAL 2001,2002
  SOUT 1=2001 AND NOT (2003 OR NOT 2002)
  both=SIG(1)
  DLYSIG 2,0.05
  SWAIT 2
  later=SIG(2)
  BITS32 101,20=65541
  wide=BITS32(101,20)
  RUNMASK 5
  SIGNAL 5
.END
