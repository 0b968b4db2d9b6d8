; A string that was never set.
; stops: E0104 main 1
.PROGRAM main()
  $a="x"+$b
.END
