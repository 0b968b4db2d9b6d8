; Twenty subroutines, each called by the one before, are as many as there may be.
; stops: E0112 n20 2
.PROGRAM main()
  CALL n1
.END
.PROGRAM n1()
  depth=1
  CALL n2
.END
.PROGRAM n2()
  depth=2
  CALL n3
.END
.PROGRAM n3()
  depth=3
  CALL n4
.END
.PROGRAM n4()
  depth=4
  CALL n5
.END
.PROGRAM n5()
  depth=5
  CALL n6
.END
.PROGRAM n6()
  depth=6
  CALL n7
.END
.PROGRAM n7()
  depth=7
  CALL n8
.END
.PROGRAM n8()
  depth=8
  CALL n9
.END
.PROGRAM n9()
  depth=9
  CALL n10
.END
.PROGRAM n10()
  depth=10
  CALL n11
.END
.PROGRAM n11()
  depth=11
  CALL n12
.END
.PROGRAM n12()
  depth=12
  CALL n13
.END
.PROGRAM n13()
  depth=13
  CALL n14
.END
.PROGRAM n14()
  depth=14
  CALL n15
.END
.PROGRAM n15()
  depth=15
  CALL n16
.END
.PROGRAM n16()
  depth=16
  CALL n17
.END
.PROGRAM n17()
  depth=17
  CALL n18
.END
.PROGRAM n18()
  depth=18
  CALL n19
.END
.PROGRAM n19()
  depth=19
  CALL n20
.END
.PROGRAM n20()
  depth=20
  CALL n21
.END
.PROGRAM n21()
  depth=21
  CALL n22
.END
.PROGRAM n22()
.END
