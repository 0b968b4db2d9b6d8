; Ask before use: EXISTxxx of every kind, a program, a local.
; after: seen = 5
; after: unseen = 5
; after: here.too = 5
; after: program = -1
; after: no.program = 0
.PROGRAM main()
  r=1
  $c="x"
  @i=3
  POINT t=NULL
  POINT #j=#PPOINT(1,2,3)
  seen=-EXISTREAL("r")-EXISTCHAR("$c")-EXISTINTEGER("@i")-EXISTTRANS("t")-EXISTJOINT("#j")
  .n=EXISTREAL("q")+EXISTCHAR("$q")+EXISTINTEGER("@q")+EXISTTRANS("q")+EXISTJOINT("#q")
  unseen=5+.n
  .r=1
  .$c="x"
  .@i=3
  POINT .t=NULL
  POINT .#j=#PPOINT(1,2,3)
  .n=EXISTLOCALREAL(".r")+EXISTLOCALCHAR(".$c")+EXISTLOCALINTEGER(".@i")
  .n=.n+EXISTLOCALTRANS(".t")+EXISTLOCALJOINT(".#j")
  here.too=-.n
  program=EXISTPGM(helper)
  no.program=EXISTPGM(nobody)
.END
.PROGRAM helper()
.END
