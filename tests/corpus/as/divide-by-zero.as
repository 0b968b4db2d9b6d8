; The mean of no parts.
; stops: E0108 mean 1
; after: mean.of = undefined
.PROGRAM main()
  parts=0
  sum=0
  CALL mean(sum,parts,mean.of)
.END
.PROGRAM mean(.s,.n,.m)
  .m=.s/.n
.END
