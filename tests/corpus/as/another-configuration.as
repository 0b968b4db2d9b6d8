; A linear motion to another configuration, which the switch forbids.
; stops: E1184 main 4
.PROGRAM main()
  LDEPART 30
  BREAK
  CONF_VARIABLE OFF
  LMOVE #[0,0,-90,180,90,-180]
.END
