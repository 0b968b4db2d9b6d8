; A number and a text do not add up.
; stops: P0114 main 1
.PROGRAM main()
  $a=1+"x"
.END
