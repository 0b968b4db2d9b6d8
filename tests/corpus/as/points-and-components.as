; POINT copies a place or parts of it; joint values from a pose by the inverse.
; after: place = (1, 20, 30, 40, 50, 60)
; after: turned = (7, 8, 9, 40, 50, 60)
; after: o = (0, 0, 0, 10, 0, 0)
; after: at = (0, 0, 0, 0, 20, 30)
; after: same = 0 +- 0.01
; after: local.x = 5
; after: rel = (7, 0, 0, 0, 0, 0)
.PROGRAM main()
  POINT .src=TRANS(10,20,30,40,50,60)
  POINT place=.src
  POINT .one=TRANS(1,2,3,10,20,30)
  POINT/X place=.one
  POINT turned=TRANS(7,8,9)
  POINT/OAT turned=.src
  POINT o=NULL
  POINT/O o=.one
  POINT at=NULL
  POINT/A at=.one
  POINT/T at=.one
  POINT .yz=NULL
  POINT/Y .yz=.one
  POINT/Z .yz=.one
  local.x=DY(.yz)+DZ(.yz)
  POINT #j=HERE
  POINT .back=#j
  same=DISTANCE(.back,HERE)
  POINT rel=TRANS(7)
.END
