; A text for a number.
; stops: P0138 main 1
.PROGRAM main()
  CALL half("four")
.END
.PROGRAM half(.x)
  .x=.x/2
.END
