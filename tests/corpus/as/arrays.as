; A tray of three rows and four columns: sparse arrays of up to three dimensions.
; after: count = 12
; after: full[2,3] = 23
; after: cube[1,2,3] = 123
; after: first = 1
; after: last = 12
; after: single = -1
; after: unknown = -2
; after: sparse[9999] = 7
.PROGRAM main()
  count=0
  FOR .row=1 TO 3
    FOR .col=1 TO 4
      full[.row,.col]=.row*10+.col
      count=count+1
      list[count]=full[.row,.col]
    END
  END
  cube[1,2,3]=123
  sparse[9999]=7
  first=MININDEX("list")
  last=MAXINDEX("list")
  single=MAXINDEX("count")
  unknown=MAXINDEX("nobody")
.END
