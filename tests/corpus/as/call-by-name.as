; SCALL: the program's name is text; with a result variable a wrong name is no stop.
; after: ran = 2
; after: good = 0
; after: bad = -30105
.PROGRAM main()
  ran=0
  $job="job"
  SCALL $job+"1"
  SCALL $job+"2",good
  SCALL $job+"3",bad
.END
.PROGRAM job1()
  ran=ran+1
.END
.PROGRAM job2()
  ran=ran+1
.END
