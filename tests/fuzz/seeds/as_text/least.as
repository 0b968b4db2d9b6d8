.PROGRAM main()
  x=1
.END
