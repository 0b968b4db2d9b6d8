; Joint 2 ends at 135 degrees.
; stops: E6007 main 1
.PROGRAM main()
  JMOVE #[0,150,-90,0,-90,0]
.END
