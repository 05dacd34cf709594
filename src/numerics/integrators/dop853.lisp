;;; anmech: Dormand and Prince's explicit Runge-Kutta method of order 8 with error estimates of orders 5 and 3.
;;;
;;; It registers itself as method = dop853.  What it keeps of a step is an array: the time, the length of the step, and
;;; eight coefficients of each state, of an interpolant of order 7.  All stages are written into the one array that the
;;; field sees, so a step allocates nothing else.
;;;
;;; Literature: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed. 1993, II.5 (the
;;; method), II.6 (dense output of order 7).  The coefficients are those of the authors' program dop853.f, rounded to
;;; the nearest double; but for one of each of the stages k8 to k12 and two of the weights, which are moved by what
;;; roundings leave, 2e-15 at most, so that the sums are what they are to be: of a stage the fraction of the step, of
;;; the weights 1, of their products with the fractions 1/2.  Else all steps would gain or lose energy alike, about
;;; 1e-16 of it in a swing, which integrations of all tolerances have in common, so that no comparison of them tells it.
;;; (E. Hairer, R. I. McLachlan, A. Razakarivony, Achieving Brouwer's law with implicit Runge-Kutta methods, BIT 48
;;; (2008) 231.)

(in-package :anmech)
(needs "arithmetic/floats" "numerics/accuracy" "numerics/integration" "numerics/methods")

;;; One step

(defmacro with-stages ((run) &body body)
  "BODY as in WITH-RUN, and with the stages k1 to k16."
  (let ((names (loop for i from 1 to 16 collect (intern (format nil "K~d" i) :anmech))))
    `(with-run (,run)
       (let ((stages (run-work ,run)))
         (declare (simple-vector stages))
         (let ,(loop for name in names for i from 0 collect `(,name (aref stages ,i)))
           (declare (type (simple-array double-float (*)) ,@names) (ignorable ,@names))
           ,@body)))))

(defmacro combination (&rest weighted)
  "The sum of the (weight array) at index i, or (weight array other) for the difference of two.  Stages at nearly the
same time are nearly alike; with large weights of both signs they are taken by differences, else what is rounded would
be many times larger than what is left, and the same in all steps that are alike."
  `(flo (+ ,@(loop for (weight array other) in weighted
                   collect (if other
                               `(* ,weight (- (aref ,array i) (aref ,other i)))
                               `(* ,weight (aref ,array i)))))))

(defmacro stage-state (&rest weighted)
  "What the field sees of state i: that at the beginning of the step and h*(sum of WEIGHTED)."
  `(flo (+ (aref state i) (* h (combination ,@weighted)))))

(defmacro last-stage-state (first)
  "The same in the last of the stages, which is at the end of the step; FIRST: the rates at its beginning."
  `(stage-state (2.273310147516538d0 ,first) (-10.53449546673725d0 k4) (-2.0008720582248625d0 k5)
                (-17.9589318631188d0 k6 k8) (27.94888452941996d0 k7 k8) (7.130954389166137d0 k8)
                (-8.87285693353063d0 k9 k10) (3.487710242263674d0 k10) (0.6433927460157634d0 k11)))

(defmacro fill-stage (target fraction &rest weighted)
  "TARGET: the rates at time + FRACTION*h and the states of STAGE-STATE."
  `(fill-stage-of ,target ,fraction (stage-state ,@weighted)))

(defmacro fill-stage-of (target fraction seen)
  `(progn
     (for (i n) (setf (aref in i) ,seen))
     (setf (aref in n) (flo (+ now (* ,fraction h))))
     (funcall field in ,target)))

(defun begin-dop853 (run)
  "The first rates, k1."
  (let ((stages (or (run-work run)
                    (setf (run-work run) (coerce (loop repeat 16 collect (zeros (run-n run))) 'simple-vector)))))
    (incf (run-evaluations run))
    (funcall (the function (run-field run)) (run-in run) (svref stages 0))
    (svref stages 0)))

(defun attempt-dop853 (run)
  "Fill the stages k2 to k12 and the state at the end of the step, and estimate the error in units of the tolerance."
  (declare (type run run))
  (incf (run-evaluations run) 11)
  (with-stages (run)
    (fill-stage k2 0.05260015195876773d0 (0.05260015195876773d0 k1))
    (fill-stage k3 0.0789002279381516d0 (0.0197250569845379d0 k1) (0.0591751709536137d0 k2))
    (fill-stage k4 0.1183503419072274d0 (0.02958758547680685d0 k1) (0.08876275643042054d0 k3))
    (fill-stage k5 0.2816496580927726d0
           (0.2413651341592667d0 k1) (-0.8845494793282861d0 k3) (0.924834003261792d0 k4))
    (fill-stage k6 0.3333333333333333d0
           (0.037037037037037035d0 k1) (0.17082860872947386d0 k4) (0.12546768756682242d0 k5))
    (fill-stage k7 0.25d0
           (0.037109375d0 k1) (0.17025221101954405d0 k4) (0.06021653898045596d0 k5) (-0.017578125d0 k6))
    (fill-stage k8 0.3076923076923077d0
           (0.03709200011850479d0 k1) (0.17038392571223998d0 k4) (0.10726203044637328d0 k5)
           (-0.015319437748624364d0 k6) (0.008273789163814023d0 k7))
    (fill-stage k9 0.6512820512820513d0
           (0.624110958716076d0 k1) (-3.3608926294469414d0 k4) (-0.868219346841726d0 k5) (27.59209969944671d0 k6 k8)
           (20.154067550477894d0 k7 k8) (4.256283068854643d0 k8))
    (fill-stage k10 0.6d0
           (0.47766253643826434d0 k1) (-2.4881146199716677d0 k4) (-0.590290826836843d0 k5) (21.230051448181193d0 k6 k8)
           (15.279233632882423d0 k7 k8) (3.221074112078753d0 k8) (-0.02033120170850683d0 k9))
    (fill-stage k11 0.8571428571428571d0
           (-0.9371424300859882d0 k1) (5.186372428844064d0 k4) (1.0914373489967295d0 k5) (-8.149787010746927d0 k6 k8)
           (-18.52006565999696d0 k7 k8) (-3.9303655713933807d0 k8) (2.4936055526796523d0 k9)
           (-3.0467644718982196d0 k10))
    (fill-stage-of k12 1d0 (last-stage-state k1))
    (let ((fifth 0d0) (third 0d0) (relative (control relative)) (absolute (run-absolute run)))
      (declare (double-float fifth third relative) (type (simple-array double-float (*)) absolute))
      (for (i n)
        (let* ((slope (combination (0.05429373411656855d0 k1) (4.450312892752409d0 k6 k8)
                                   (1.8915178993145003d0 k7 k8) (0.5406268320563246d0 k8) (0.3111643669578199d0 k9)
                                   (-0.1521609496625161d0 k10) (0.20136540080403034d0 k11) (0.04471061572777273d0 k12)))
               (value (flo (+ (aref state i) (* h slope))))
               (unit (flo (max (+ (aref absolute i) (* relative (max (abs (aref state i)) (abs value)))) +least-unit+)))
               (e3 (flo (/ (- slope (combination (0.244094488188976377952755905512d0 k1)
                                                 (0.733846688281611857341361741547d0 k9)
                                                 (0.0220588235294117647058823529412d0 k12)))
                           unit)))
               (e5 (flo (/ (combination (0.01312004499419488d0 k1) (-1.2251564463762044d0 k6)
                                        (-0.4957589496572502d0 k7) (1.6643771824549864d0 k8)
                                        (-0.35032884874997366d0 k9) (0.3341791187130175d0 k10)
                                        (0.08192320648511571d0 k11) (-0.022355307863886294d0 k12))
                           unit))))
          (declare (double-float slope value unit e3 e5))
          (setf (aref next i) value)
          (setq third (flo (+ third (* e3 e3)))
                fifth (flo (+ fifth (* e5 e5))))))
      (let ((both (flo (+ fifth (* 0.01d0 third)))))
        (declare (double-float both))
        (setf (control error)
              (if (> both 0d0)
                  (flo (/ (* (abs h) fifth) (sqrt (* both (+ 0d0 n)))))
                  (flo (* both 0d0))))))           ; 0, or NaN if the state is
    nil))

(defun load-end-of-step (run)
  (with-run (run)
    (for (i n) (setf (aref in i) (aref next i)))
    (setf (aref in n) (flo (+ now h)))
    nil))

(defun find-last-rates (run)
  "The rates at the end of the step, k13, which begin the next one."
  (declare (type run run))
  (load-end-of-step run)
  (incf (run-evaluations run))
  (with-stages (run)
    (funcall field in k13)
    nil))

(defun turn-stages (run)
  (let ((stages (run-work run)))
    (declare (simple-vector stages))
    (rotatef (aref stages 0) (aref stages 12))
    nil))

(defun complete-dop853 (run)
  "Go to the end of the step; what is kept of it."
  (find-last-rates run)
  (let ((kept (dense-step run)))
    (turn-stages run)
    kept))

(defun sketch-dop853 (run)
  (find-last-rates run)
  (turn-stages run))

(defun dense-step (run)
  "The array (time, step, coefficients) of the interpolant of order 7 over the step."
  (incf (run-evaluations run) 3)
  (with-stages (run)
    (let ((step (zeros (fix (+ 2 (* 8 n))))))
      (declare (type (simple-array double-float (*)) step))
      (fill-stage k14 0.1d0
             (0.056167502283047954d0 k1) (0.25350021021662483d0 k7) (-0.2462390374708025d0 k8)
             (-0.12419142326381637d0 k9) (0.15329179827876568d0 k10) (0.00820105229563469d0 k11)
             (0.007567897660545699d0 k12) (-0.008298d0 k13))
      (fill-stage k15 0.2d0
             (0.03183464816350214d0 k1) (0.028300909672366776d0 k6) (0.053541988307438566d0 k7)
             (-0.05492374857139099d0 k8) (-0.00010834732869724932d0 k11) (0.0003825710908356584d0 k12)
             (-0.00034046500868740456d0 k13) (0.1413124436746325d0 k14))
      (fill-stage k16 0.7777777777777778d0
             (-0.42889630158379194d0 k1) (-4.697621415361164d0 k6) (7.683421196062599d0 k7) (4.06898981839711d0 k8)
             (0.3567271874552811d0 k9) (-0.0013990241651590145d0 k13) (2.9475147891527724d0 k14)
             (-9.15095847217987d0 k15))
      (setf (aref step 0) now
            (aref step 1) h)
      (macrolet ((store (k form) `(setf (aref step (the fixnum (+ place ,k))) ,form)))
        (for (i n)
          (let* ((place (the fixnum (+ 2 (the fixnum (* 8 i)))))
                 (rise (flo (- (aref next i) (aref state i))))
                 (bend (flo (- (* h (aref k1 i)) rise))))
            (declare (fixnum place) (double-float rise bend))
            (store 0 (aref state i))
            (store 1 rise)
            (store 2 bend)
            (store 3 (flo (- rise (* h (aref k13 i)) bend)))
            (store 4 (flo (* h (combination
                                (-8.428938276109013d0 k1) (0.5667149535193777d0 k6) (-3.0689499459498917d0 k7)
                                (2.38466765651207d0 k8) (2.117034582445028d0 k9) (-0.871391583777973d0 k10)
                                (2.2404374302607883d0 k11) (0.6315787787694688d0 k12) (-0.08899033645133331d0 k13)
                                (18.148505520854727d0 k14) (-9.194632392478356d0 k15) (-4.436036387594894d0 k16)))))
            (store 5 (flo (* h (combination
                                (10.427508642579134d0 k1) (242.28349177525817d0 k6) (165.20045171727028d0 k7)
                                (-374.5467547226902d0 k8) (-22.113666853125306d0 k9) (7.733432668472264d0 k10)
                                (-30.674084731089398d0 k11) (-9.332130526430229d0 k12) (15.697238121770845d0 k13)
                                (-31.139403219565178d0 k14) (-9.35292435884448d0 k15) (35.81684148639408d0 k16)))))
            (store 6 (flo (* h (combination
                                (19.985053242002433d0 k1) (-387.0373087493518d0 k6) (-189.17813819516758d0 k7)
                                (527.8081592054236d0 k8) (-11.57390253995963d0 k9) (6.8812326946963d0 k10)
                                (-1.0006050966910838d0 k11) (0.7777137798053443d0 k12) (-2.778205752353508d0 k13)
                                (-60.19669523126412d0 k14) (84.32040550667716d0 k15) (11.99229113618279d0 k16)))))
            (store 7 (flo (* h (combination
                                (-25.69393346270375d0 k1) (-154.18974869023643d0 k6) (-231.5293791760455d0 k7)
                                (357.6391179106141d0 k8) (93.40532418362432d0 k9) (-37.45832313645163d0 k10)
                                (104.0996495089623d0 k11) (29.8402934266605d0 k12) (-43.53345659001114d0 k13)
                                (96.32455395918828d0 k14) (-39.17726167561544d0 k15) (-149.72683625798564d0 k16))))))))
      step)))

;;; Stability

(defconstant +stable+ 6.1d0 "The product of a step and the rate of a decay up to which the method is stable.")

(defun dop853-decay (run)
  "After a step that was completed: the rate at which that decays in which its two last states differ, measured in units
of the tolerance; 0 if it does not decay, as what oscillates or grows.  (Where stability bounds the steps it is what
decays fastest.)"
  (declare (type run run))
  (with-stages (run)
    (let ((relative (control relative)) (absolute (run-absolute run)) (states 0d0) (rates 0d0) (both 0d0))
      (declare (double-float relative states rates both) (type (simple-array double-float (*)) absolute))
      (for (i n)                             ; the stages are turned: k13 is what k1 was, k1 the rates at the end
        (let* ((unit (flo (max (+ (aref absolute i) (* relative (abs (aref next i)))) 1d-290)))
               (state-change (flo (/ (- (aref next i) (last-stage-state k13)) unit)))
               (rate-change (flo (/ (- (aref k1 i) (aref k12 i)) unit))))
          (declare (double-float unit state-change rate-change))
          (setq states (flo (+ states (* state-change state-change)))
                rates (flo (+ rates (* rate-change rate-change)))
                both (flo (+ both (* state-change rate-change))))))
      (if (and (> states 0d0) (< (flo (* both (control direction))) (flo (* -0.5d0 (sqrt states) (sqrt rates)))))
          (flo (/ (sqrt rates) (sqrt states)))
          0d0))))

;;; Dense output

(defun dop853-value (step time out n)
  (declare (type (simple-array double-float (*)) step out) (double-float time) (fixnum n))
  (with-fast-arithmetic
    (let* ((s (flo (/ (- time (aref step 0)) (aref step 1))))
           (r (flo (- 1d0 s))))
      (declare (double-float s r))
      (for (i n)
        (let ((place (the fixnum (+ 2 (the fixnum (* 8 i))))))
          (declare (fixnum place))
          (macrolet ((part (k) `(aref step (the fixnum (+ place ,k)))))
            (setf (aref out i)
                  (flo (+ (part 0)
                          (* s (+ (part 1)
                                  (* r (+ (part 2)
                                          (* s (+ (part 3)
                                                  (* r (+ (part 4)
                                                          (* s (+ (part 5)
                                                                  (* r (+ (part 6) (* s (part 7))))))))))))))))))))
      nil)))

;;; The method

(defvar *dop853*
  (make-formula :order 8 :begin #'begin-dop853 :attempt #'attempt-dop853 :complete #'complete-dop853
                :sketch #'sketch-dop853 :decay #'dop853-decay :stable +stable+ :value #'dop853-value
                :room (lambda (n) (+ 2 (* 8 n)))))

(register-integrator "dop853"
                     :suits (constantly 1)
                     :run (lambda (task) (motion-by-formula task *dop853*)))
