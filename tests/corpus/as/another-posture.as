; A turn across a stretched wrist: only another posture of the arm goes on there.
; stops: E6008 main 5
.PROGRAM main()
  JMOVE #[0,20,-60,0,0,0]
  BREAK
  SPEED 20 MM/S
  HERE p
  LMOVE p+RY(10)
.END
