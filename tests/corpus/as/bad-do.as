; A DO without UNTIL.
; mistake: P0144 4
.PROGRAM main()
  DO
    x=1
.END
