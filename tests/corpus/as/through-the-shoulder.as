; The wrist in the middle of the shoulder, where the upper arm cannot fold it to: singular.
; stops: E6016 main 1
.PROGRAM main()
  JMOVE TRANS(5,5,-78,0,180,0)
.END
