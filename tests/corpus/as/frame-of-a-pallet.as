; Three taught corners make a pallet's frame; places on it are composed.
; after: x = 100 +- 0.01
; after: y = 230 +- 0.01
; after: z = 50 +- 0.01
; after: turned = 90 +- 0.01
; after: raised = 55 +- 0.01
; after: r.x = -1 +- 0.00001
; after: r.z = 45 +- 0.001
; after: inverse = 0 +- 0.001
.PROGRAM main()
  POINT corner=TRANS(100,200,50)
  POINT along=TRANS(100,300,50)
  POINT across=TRANS(0,200,50)
  POINT pallet=FRAME(corner,along,across,corner)
  POINT place=pallet+TRANS(30)
  x=DX(place)
  y=DY(place)
  z=DZ(place)
  turned=DEXT(pallet,4)+DEXT(pallet,6)
  raised=DZ(pallet+TRANS(0,0,5))
  POINT .a=RX(90)+TRANS(0,0,1)
  r.x=DY(.a)
  POINT .b=RZ(45)
  r.z=DEXT(.b,4)+DEXT(.b,6)
  POINT .c=RY(30)-RY(30)
  inverse=DISTANCE(.c+place,place)
.END
