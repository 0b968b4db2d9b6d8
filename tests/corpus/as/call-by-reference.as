; Subroutines change what they are given: numbers, strings, poses, whole arrays.
; after: a = 2
; after: b = 1
; after: $name = "bolt!"
; after: place = (10, 20, 30, 0, 0, 0)
; after: sum = 60
; after: depth = 5
.PROGRAM main()
  a=1
  b=2
  CALL swap(a,b)
  $name="bolt"
  CALL shout($name)
  POINT place=TRANS(10,20)
  CALL lift(&place,30)
  FOR .i=1 TO 3
    n[.i]=10*.i
  END
  CALL total(n[],sum)
  depth=0
  CALL deeper(5)
.END
.PROGRAM swap(.x,.y)
  .t=.x
  .x=.y
  .y=.t
.END
.PROGRAM shout(.$s)
  .$s=.$s+"!"
.END
.PROGRAM lift(.&p,.mm)
  POINT .p=SHIFT(.p BY 0,0,.mm)
.END
.PROGRAM total(.v[],.s)
  .s=0
  FOR .i=1 TO MAXINDEX(".v")
    .s=.s+.v[.i]
  END
.END
.PROGRAM deeper(.n)
  depth=depth+.n
  RETURN
  depth=-1
.END
