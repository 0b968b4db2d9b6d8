; A log line that grows beyond 255 characters.
; stops: E0110 main 3
; after: length = 250
.PROGRAM main()
  $log=$SPACE(250)
  length=LEN($log)
  $log=$log+"123456"
.END
