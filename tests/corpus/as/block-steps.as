; Block steps of the pendant: parsed, refused when one is reached.
; stops: E0111 main 2
; after: before = 1
.PROGRAM main()
  before=1
  JOINT SPEED9 ACCU1 TIMER0 TOOL1 WORK0 CLAMP1 (OFF,0,0,O) OX= WX= #[10,20,-30,0,-40,0] ;
  LINEAR 30.0 ACCU1 TIMER0 TOOL1 WORK0 CLAMP OX= WX= #[10,20,-30,0,-40,0]
.END
